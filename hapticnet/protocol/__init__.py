"""Datagrams and sessions, sans-I/O. docs/refer/protocol.md is their specification; payloads are opaque here."""
