"""The bench wing: an open folder, one module a lab measurement. Each has `Settings` and `measure(frames, settings, calmap)`."""
