"""Open folder of trials. Each file offers `trial(cases, calmap, finders, settings, tick) -> (Trial, details)`, the whole chain
against truth (see validate/case.py), and `variants(calmap)`, the maps it tries."""
