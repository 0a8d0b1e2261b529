"""Open folder: the report's sections. Each file has ORDER, TITLE and render(story) -> Section, or None: nothing to say."""
