"""Self-contained HTML reports: one file that opens without a network and prints well."""
