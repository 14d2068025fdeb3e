"""Programs for a controller: KRL, RSI tables, joint tables."""
