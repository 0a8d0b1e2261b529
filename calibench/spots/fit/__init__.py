"""The photon-weighted fit of a Gaussian of known shape, compiled."""
