"""Codecs: which stimuli are transmitted, as which bytes, and what the receiver applies in between."""
