"""C99 source of an identified model: straight-line code for one robot."""
