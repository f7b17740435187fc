"""Commands before an identification: robot files, motions, a look at recordings."""
