"""The wire contract, version 1: what phones and pages exchange with the service. See docs/protocol.md.

It imports nothing else of the server, so that a client can be built on it alone.
"""
