"""What a site and a robot may set: models, bounds, presets, loading."""
