"""The gate's kernel: certifies tubes and looks at many pairs of bodies, in machine code and without allocating.

`decision` divides tubes into `pieces` until every pair of bodies is shown to keep apart in them. In each piece `place`
says where bodies are, and `look` which pairs have not the room that is asked for: by balls, by tight boxes, by the
distance at the middle (`gap`), and by planes over a whole span. `span` finds a span around a path, `course` the
setpoints of a motion and its brake. All of them work on `arrays`, which are filled once and written over and over.
"""
