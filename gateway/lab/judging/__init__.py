"""Models held against recordings: skill, validation, ranking."""
