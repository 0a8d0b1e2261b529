"""Open folder of spot detectors: `detect(signal_dn, noise_dn, unusable, sensitivity) -> Candidates`."""
