"""Calibration points of a target in a view: an open folder, one module a detector.

Each has `TARGET` (the kind of target it finds), `POINT` (what its points are, in words), `WINDOWS` (least and most half width
of the refinement, in spacings of the nearest neighbour), `points(board)` (P, 2): places of the points in squares,
`find(grey, target)`: (P, 2) px to about a pixel, NaN where a point is not seen, None where the target is not, and
`may_go_on(grey, xy_px, board)`: whether the target may be larger than said, so that it is worth a search. Sub-pixel places and
their covariance come from one refiner for all of them (`_symmetry`): each point of each target is a centre of symmetry.
"""
