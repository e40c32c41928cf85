"""A batch: layout, tables and settings, one process per fruit, kept results, records, provenance."""
