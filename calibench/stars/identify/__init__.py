"""Open folder of identifiers, lost in space. Each file offers

    NEEDS_SCALE          True: works with absolute angles, so the lens or the field must be known
    Table                the type of its table: a NamedTuple of numpy arrays (so that it can be kept between runs)
    table_key(view)      what part of the sky's patterns this view needs (hashable; like views should share one)
    build(sky, key)      that Table, from the stars of a SkyCatalogue, brightest first
    propose(view, sky, table) -> Iterator[(spot_rows (B, k), star_rows (B, k))], k >= 2

A proposal is only a suspicion that these spots are those stars, in that order. stars/verify.py fits each, weeds, compares with
all stars in view and gives the odds, all of it compiled: a false proposal costs a microsecond, a missing one the frame.
Yield small batches, the likeliest first: the search ends with the batch in which a match is believed. A pair (k = 2) does not
tell a mirrored image: through a guessed lens only k >= 3 finds one.

Bricks: `view.directions` (N, 3) of the spots, brightest first, and `view.sigma_rad` (N,), from which every tolerance follows
(`side_tolerance` in stars/view.py for an angle); `field_key` for tables by field size; `circles.brightest_groups` for the
groups of stars that a camera sees first; `CodeTable` to find a group again by any short vector, `_features.py` for triangles by
any code of their corners, tolerances included; `StarPairs` for angles; `_neighbourhoods.py` for the stars around a star;
`_votes.py` where stars vote for a spot; `sky.grid` with `kernels.stars_near` for the star in a direction. Loops go into
kernels.py of this folder.
"""
