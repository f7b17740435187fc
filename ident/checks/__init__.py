"""Checks of robot files, connections and recordings (`dynid check`, `dynid info`)."""
