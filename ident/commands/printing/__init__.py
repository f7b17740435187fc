"""What commands print for people: results, verdicts, and checks of robots and recordings."""
