"""The ground floor: arrays, errors, clock, units, ranges, text, files, validation; knows neither bus nor robot."""
