"""Codecs: which stimuli to send, how to encode them, and what the receiver applies in between."""
