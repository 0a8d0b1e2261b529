"""Frames of a series on their way into sums: exact stacks, and what is noticed of each frame as it passes."""
