"""calibench: camera calibration and characterization for star cameras.

Two wings on one hub: `measure` turns lab frames into measurements, `calmap` turns measurements into one calibration
map and applies it, `stars` turns corrected frames into an attitude. Importing this package loads nothing heavy.
"""

__version__ = "0.1.0"
