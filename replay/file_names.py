"""Names of files, whatever datasets and logs call what they hold."""

from hashlib import blake2b

_MAX_BYTES = 180
"""File systems take 255, and what is being written has a longer name."""


def file_name(name: str) -> str:
    """Return a name without a suffix, at most 180 bytes: anything but letters, digits and `._-+` becomes `_`, and so
    does a point at the beginning: such files are hidden, or are folders.
    """
    text = "".join(c if c.isalnum() or c in "._-+" else "_" for c in name)
    text = f"_{text[1:]}" if text.startswith(".") or not text else text
    return text if len(text.encode()) <= _MAX_BYTES else told_apart(text, name)


def told_apart(text: str, name: str) -> str:
    """Return the name `text` of a file with a digest of `name` behind it, at most 180 bytes."""
    digest = blake2b(name.encode(errors="surrogatepass"), digest_size=4).hexdigest()
    short = text.encode()[: _MAX_BYTES - 1 - len(digest)].decode(errors="ignore")
    return f"{short}-{digest}"
