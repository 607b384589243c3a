"""Results as files: `written` writes a drive's tables, `reading` opens them again.

Each format has its module: `parquet`, `csv_text`, `mf4`, `mcap_log`. All of them write in pieces
and in bounded memory. A file has a temporary name until it is complete.
"""
