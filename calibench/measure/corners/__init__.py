"""Calibration points of a target in a view: an open folder, one module a detector.

Each has `TARGET` (the kind of target it finds), `POINT` (what its points are, in words), `WINDOWS` (least and most half width
of the refinement, in spacings of the nearest neighbour), `points(board)` (P, 2): places of the points in squares,
`find(grey, target)`: (P, 2) px to about a pixel, NaN where a point is not seen, None where the target is not, and
`shown(grey, target)`: how many columns and rows of points a view shows, None where that is not known. Sub-pixel places and
their covariance come from one refiner for all of them (`_symmetry`): each point of each target is a centre of symmetry.
"""
