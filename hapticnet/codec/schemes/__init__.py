"""The compression schemes, one file each."""
