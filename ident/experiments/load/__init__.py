"""The load on an arm's tool."""
