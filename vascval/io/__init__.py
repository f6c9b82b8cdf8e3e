"""Reading and writing: volumes, trees, tables, schemas, provenance."""
