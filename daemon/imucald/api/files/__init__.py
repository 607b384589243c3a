"""Results as files: `written` writes a drive's tables, `reading` opens them again.

One module a format: `parquet`, `csv_text`, `mf4`, `mcap_log`. All write in pieces, in bounded
memory, under a name that is taken only when the file is whole.
"""
