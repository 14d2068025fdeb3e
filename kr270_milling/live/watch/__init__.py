"""A live view of a running pass: a small read-only page on this host, fed from the topics of the graph."""
