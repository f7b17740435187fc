"""Judgement of a recording: clocks, sampling, noise, outliers, and whether it follows its commands."""
