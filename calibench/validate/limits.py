"""Acceptance limits: is what was measured good enough?"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

from ..errors import BadInput
from ..records import Limit, Quantity, Verdict


def judge(quantities: Mapping[str, Quantity], limits: Iterable[Limit]) -> tuple[Verdict, ...]:
    """One verdict for each limit, in their order.

    quantities: by "measurement.quantity", as `CalibrationMap.quantities` holds them.
    A limit is met at its boundary. A quantity that was not measured, has no value, or stands in another unit than the
    limit is `skipped` with the reason: it is neither good nor bad, and a report shows it.

    Raises:
        BadInput: a limit bounds nothing, or its minimum lies above its maximum.
    """
    return tuple(_judge_one(quantities, limit) for limit in limits)


def _judge_one(quantities: Mapping[str, Quantity], limit: Limit) -> Verdict:
    key = f"{limit.measurement}.{limit.quantity}"
    low = -math.inf if limit.minimum is None else limit.minimum
    high = math.inf if limit.maximum is None else limit.maximum
    if not low <= high or (low, high) == (-math.inf, math.inf):
        raise BadInput(f"the limit on {key} accepts nothing or everything (minimum {limit.minimum}, "
                       f"maximum {limit.maximum})", mend="give a minimum, a maximum, or both in rising order")

    quantity = quantities.get(key)
    if quantity is None:
        return Verdict(limit=limit, status="skipped", reason=_why_absent(quantities, limit))
    if quantity.value is None or math.isnan(quantity.value):
        return Verdict(limit=limit, status="skipped", reason=quantity.reason or "the measurement gave no value")
    if limit.unit and limit.unit != quantity.unit:
        return Verdict(limit=limit, status="skipped", value=quantity.value, uncertainty=quantity.uncertainty,
                       reason=f"the limit is in {limit.unit}, the quantity in {quantity.unit or 'no unit'}")
    return Verdict(limit=limit, status="pass" if low <= quantity.value <= high else "fail",
                   value=quantity.value, uncertainty=quantity.uncertainty, reason=_sentence(quantity, low, high))


def _why_absent(quantities: Mapping[str, Quantity], limit: Limit) -> str:
    prefix = f"{limit.measurement}."
    siblings = sorted(key.removeprefix(prefix) for key in quantities if key.startswith(prefix))
    if not siblings:
        return f"{limit.measurement} was not measured"
    return f"{limit.measurement} gives no {limit.quantity}; it gives: {', '.join(siblings)}"


def _sentence(quantity: Quantity, low: float, high: float) -> str:
    """Where the value lies, and whether its uncertainty could turn the verdict."""
    value, unit = quantity.value, f" {quantity.unit}" if quantity.unit not in ("", "1") else ""
    if value < low:
        said = f"{value:.6g}{unit} is below {low:.6g}"
    elif value > high:
        said = f"{value:.6g}{unit} is above {high:.6g}"
    else:
        said = f"{value:.6g}{unit} is within the limit"
    margin = min(abs(value - low), abs(value - high))
    if quantity.uncertainty is not None and margin < quantity.uncertainty:
        said += f"; its 1-sigma uncertainty {quantity.uncertainty:.2g} reaches across the limit"
    return said
