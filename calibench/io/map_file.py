"""The map file in one place: write it, read it, verify it, ask it. The layout is described in `map_layout`."""

from .map_read import Check, map_info, read_map, verify_map
from .map_write import encode_map, write_map

__all__ = ["Check", "encode_map", "map_info", "read_map", "verify_map", "write_map"]
