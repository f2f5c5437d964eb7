"""The gate's kernel: looks at many pairs of bodies, in machine code and without allocating.

`place` says where bodies are, and `look` which pairs have not the room that is asked for: by balls and boxes, by the
distance at the middle (`gap`, with the search of `simplex`), and by planes over a whole strip (`planes`).
`strip` finds a strip around a path. All of them work on `arrays`, which are filled once and written over and over.
"""
