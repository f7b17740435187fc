"""The identified model at work: external torque, contacts and load of an arm, over recordings and sample by sample."""
