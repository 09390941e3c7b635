"""Datagrams and sessions, sans-I/O. docs/protocol.md is their specification; payloads are opaque here."""
