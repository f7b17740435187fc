"""The sections of the report, one module each: `section(data)` gives a title, a template and its context."""
