"""Do the times at which frames were taken leave room for the exposures that they state?

A wrong unit of time shows in nothing else where the dark signal is small: milliseconds read as seconds make a dark current that
is a thousand times too good.
"""

from __future__ import annotations

from collections.abc import Sequence

from ...errors import BadInput
from ...records.frame import utc

FEWEST = 3  # different times; fewer may be one stamp for all
SURELY, DOUBTFUL = 0.1, 0.9  # of the exposures' sum: what passed from the first start to the last


def check_clock(taken: Sequence[tuple[str, float]]) -> tuple[str, ...]:
    """What has to be said of frames whose starts lie closer together than their exposures allow; nothing where they do not.

    Args:
        taken: (ISO 8601 start, UTC where no offset is stated; exposure in s) of each frame that states both.

    Raises:
        BadInput: there was no time for a tenth of the exposures.
    """
    frames = sorted((utc(date).timestamp(), exposure_s) for date, exposure_s in taken)
    starts = {start for start, _ in frames}
    if len(starts) < FEWEST:
        return ()
    passed_s, exposed_s = max(starts) - min(starts), sum(exposure_s for _, exposure_s in frames[:-1])
    said = f"the frames state exposures of {exposed_s:.3g} s together, but were taken within {passed_s:.3g} s"
    if passed_s < SURELY * exposed_s:
        raise BadInput(said, mend="give exposures in seconds; are the times those of the camera (date_obs, DATE-OBS)?")
    return (f"{said}: are the exposures in seconds?",) if passed_s < DOUBTFUL * exposed_s else ()
