"""Codecs of the literature for hapticnet, made with nothing but its door for codecs of users."""
