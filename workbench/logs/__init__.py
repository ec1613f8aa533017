"""Run logs: one Parquet file per run, and the crash-safe journal that becomes one."""
