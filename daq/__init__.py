"""What happens while a robot moves: the robot file, the recording and its importers."""
