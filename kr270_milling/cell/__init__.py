"""The cell: its parameter file as records, the models that it makes, its jobs."""
