"""The version of our recordings' channels and schemas, and where a file has it."""

#: Files of a newer one are refused.
FORMAT = 1
#: Every channel's metadata has it under this key.
FORMAT_KEY = "kontur-av format"
