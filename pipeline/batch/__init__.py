"""A batch on disk: layout, tables, settings, confirmed effects, records, cached results, provenance."""
