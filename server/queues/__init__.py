"""Ports between processes: the job queue and the frame mailbox."""
