"""One module a method, found by its place in this folder and named after it: it holds a `Method` as METHOD."""
