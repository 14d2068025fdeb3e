"""Results of an identification as sentences, JSON, tables, pages and parameter files."""
