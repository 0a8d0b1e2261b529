"""Is it good enough: acceptance limits, and trials that measure the whole chain against truth."""
