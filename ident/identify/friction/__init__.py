"""Friction of an identification: the user's wishes, the choice of terms, the shapes and their error bars."""
