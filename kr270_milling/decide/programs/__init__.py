"""What a controller runs: KRL, RSI tables, joint tables."""
