"""calibench: camera calibration and characterization for star cameras.

Two wings on one hub: `measure` turns lab frames into measurements, `calmap` turns measurements into one calibration
map and applies it, `stars` turns corrected frames into an attitude. Importing this package loads nothing heavy.
"""

import os

# Read when numpy and scipy load: the matrices here are small and many, and BLAS threads that wait for each other on a busy
# machine cost ten times what they save.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

__version__ = "0.1.0"
