"""Open folder of identifiers. Each file offers

    NEEDS_SCALE          True: works with absolute angles, so the lens or the field must be known
    table_key(view)      what part of the sky's patterns this view needs (hashable)
    build(sky, key)      that table
    propose(view, sky, table) -> Iterator[(spot_rows (B, k), star_rows (B, k))]

A proposal is only a suspicion: stars/lost_in_space.py weeds, verifies, and gives the odds.
"""
