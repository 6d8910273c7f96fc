"""Reaching: joint values that put the tip at one target or at a million, and the reason where there are none.

`targets` reads targets, `starts` has postures to start from, `descent` is one try, `search` makes them in rounds and
`traced` within programs of others; `asked` has the arguments, `public` is the entry, `result` the record.
"""
