"""How a record takes an array: checked for shape, converted to its dtype, made read-only."""

from __future__ import annotations

import numpy as np

from ..errors import BadInput


def frozen(value: object, *, name: str, shape: tuple[int | None, ...], dtype: object = None) -> np.ndarray:
    """A read-only array of the wanted shape (None: any length) and dtype.

    The caller's array is not copied unless its dtype has to change; the returned view refuses to be written to.

    Raises:
        BadInput: the shape does not fit.
    """
    array = np.asarray(value, dtype=dtype)
    fits = array.shape == shape or (
        array.ndim == len(shape) and all(w is None or w == n for w, n in zip(shape, array.shape, strict=True)))
    if not fits:
        wanted = "(" + ", ".join("any" if w is None else str(w) for w in shape) + ")"
        raise BadInput(f"{name} has shape {array.shape}, expected {wanted}")
    view = array.view()
    view.flags.writeable = False
    return view


def settle(record: object, **arrays: object) -> None:
    """Replace fields of a frozen dataclass by their checked arrays; called from ``__post_init__`` only."""
    for name, array in arrays.items():
        if name not in record.__dataclass_fields__:
            raise TypeError(f"{type(record).__name__} has no field {name}")
        object.__setattr__(record, name, array)
