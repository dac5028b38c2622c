"""Effects that a scene may name, one file each: keys, determination, sentences and advice.

A scene without an effect's key loads no file of it; advice loads them all, on request.
"""
