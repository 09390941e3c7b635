"""The codecs of the plug-ins, loaded so that each file can run alone."""

from hapticnet.codec.registry import every_codec

every_codec()
