"""Parameters of many results of one arm over time: kept in SQLite, their trends and steps estimated."""
