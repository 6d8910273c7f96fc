"""Reaching: joint values that put the tip at one target or at a million, and the reason where there are none.

`targets` reads the targets, `starts` has the start postures, `descent` is one try. `search` makes tries in rounds and
goes along paths, `traced` makes the same tries within programs of others, `several` goes on to different answers.
`asked` has the arguments and what a search means, `public` is the entry, `result` the record.
"""
