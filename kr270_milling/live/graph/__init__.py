"""The graph of nodes: processes, choreography of passes, checks."""
