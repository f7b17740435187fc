"""Which friction: what the user asks for, the choice of terms, the shapes and their error bars."""
