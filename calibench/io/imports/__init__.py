"""An open folder: lenses that other programs have calibrated. A module is a format, with `read(path) -> Intrinsics`."""
