"""Tools of the photon transfer measurement: levels of light from single frames, the curve through them, the fixed patterns."""
