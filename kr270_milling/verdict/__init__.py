"""Whether the compensation can be trusted when the models are as uncertain as the configuration says."""
