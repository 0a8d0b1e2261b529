"""Point sources on a frame: detect, centroid, PSF model. Both wings need it."""
