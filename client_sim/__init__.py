"""The reference phone: a leader and a follower that replay recorded walks over the real protocol.

Of the server it knows ``server.protocol`` only, as any other client.
"""
