"""Figures of the pages, as plotly.js reads them."""
