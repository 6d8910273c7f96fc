"""Reaching: joint values that put the tip at one target or at a million, and the reason where there are none.

`targets` reads the targets, `starts` has the start postures, `descent` is one try. `search` makes tries in rounds,
`traced` makes the same ones within programs of others, `several` goes on to different answers, and `path` along a path.
`asked` has the arguments and what a search means, `public` is the entry, `result` the record.
"""
