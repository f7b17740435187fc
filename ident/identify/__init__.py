"""The main job: recordings in, validated model out."""
