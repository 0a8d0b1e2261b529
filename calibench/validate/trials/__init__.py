"""Open folder of trials. Each file offers `trial(cases, calmap, solver, progress) -> Trial`: the whole chain against truth."""
