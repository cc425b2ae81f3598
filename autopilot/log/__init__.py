"""MCAP logs: writer, reader, checks, report, plots."""
