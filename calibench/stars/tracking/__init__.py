"""Tracking: a frame of a series from the attitude before it, by windows about the places where its stars must stand."""
