"""A batch on the disk: layout, tables and settings, confirmed effects, records, kept results, provenance."""
