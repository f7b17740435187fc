"""Arms of serial bus servos: Feetech's and Dynamixel's, on one half-duplex line."""
