"""Forward simulation of an identified model: rigid bodies, viscous and dry friction, closed loops, coupled motors."""
