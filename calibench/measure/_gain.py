"""The system gain a measurement may use, and figures given in DN and in e- alike."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import BadInput
from ..records import CalibrationMap, Frame, Quantity

# figures that may have become the map's gain
MEASURED = ("transfer.gain_crosstalk_corrected_dn_per_e", "transfer.gain_dn_per_e", "flat.gain_dn_per_e")


@dataclass(frozen=True, kw_only=True)
class Gain:
    """dn_per_e: NaN where unknown. uncertainty: 1-sigma, 0 where nobody stated one. origin: who said it."""

    dn_per_e: float
    uncertainty: float = 0.0
    origin: str = ""

    def both(self, name_dn: str, name_e: str, value_dn: float | None, uncertainty_dn: float | None,
             unit_dn: str, unit_e: str, *, symbol: str, source: str, reason: str = "") -> list[Quantity]:
        """A figure in DN and in e-; the latter without a value where the gain is unknown, with the reason."""
        dn = Quantity(name=name_dn, value=value_dn, uncertainty=uncertainty_dn, unit=unit_dn, symbol=symbol, source=source,
                      reason=reason)
        if value_dn is None or not np.isfinite(self.dn_per_e):
            return [dn, Quantity(name=name_e, value=None, unit=unit_e, symbol=symbol, source=source, reason=reason or
                                 "gain unknown: measure flats first (--map), or state EGAIN in the frames")]
        value = value_dn / self.dn_per_e
        error = np.hypot(uncertainty_dn / self.dn_per_e, value * self.uncertainty / self.dn_per_e)
        return [dn, Quantity(name=name_e, value=value, uncertainty=float(error), unit=unit_e, symbol=symbol,
                             source=f"{source}; gain from {self.origin}", reason=reason)]


def known_gain(calmap: CalibrationMap | None, frame: Frame) -> Gain:
    """The map's gain if it was measured, else the frame's EGAIN, else unknown.

    Raises:
        BadInput: the map's gain was measured at another gain setting.
    """
    if calmap is not None and "gain_dn_per_e" in calmap.measured:
        theirs, mine = calmap.conditions.gain_setting, frame.gain_setting
        if theirs is not None and mine is not None and theirs != mine:
            raise BadInput(f"gain setting {mine:g}, but the map's gain was measured at {theirs:g}", file=frame.file or None,
                           mend="use a map of the same gain setting, or measure flats at this one")
        figures = [calmap.quantities.get(name) for name in MEASURED]
        error = next((q.uncertainty for q in figures if q and q.value and np.isclose(q.value, calmap.gain_dn_per_e)), None)
        return Gain(dn_per_e=calmap.gain_dn_per_e, uncertainty=error or 0.0, origin="the map")
    if frame.egain_e_per_dn:
        return Gain(dn_per_e=1 / frame.egain_e_per_dn, origin="EGAIN in the frames")
    return Gain(dn_per_e=np.nan)
