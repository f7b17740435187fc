"""Several recordings or models of one arm together: payloads, drive gains, merged models."""
