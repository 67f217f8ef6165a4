"""Results as files of other programs: universal files, tables as CSV and Parquet."""
