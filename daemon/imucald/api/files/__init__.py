"""Results as files: `written` writes the tables of a drive, `reading` opens the files again.

The formats: `arrow_files` (Parquet, CSV), `mf4`, `mcap_log`. All formats are written in
pieces and in bounded memory. A file has a temporary name until it is complete.
"""
