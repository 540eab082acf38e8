"""`python -m experiments export`: faces that perform, as files which other tools open."""
