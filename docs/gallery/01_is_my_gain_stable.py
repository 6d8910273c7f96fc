"""
Is my gain stable?
==================

x
"""
print(1)
