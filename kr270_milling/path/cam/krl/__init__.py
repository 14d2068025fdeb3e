"""Robot programs in KRL as tool paths."""
