"""Hypotheses and their verification where the lens is not known: scale, handedness and distortion are found with the stars."""
