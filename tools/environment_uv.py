# SPDX-License-Identifier: Apache-2.0
"""What uv needs to be told of pip's settings, which it does not read itself."""

from __future__ import annotations

import ast
from collections.abc import Mapping

# Of pip's options: uv's variable for the same, and what stands between the items of its lists.
SAME: dict[str, tuple[str, str]] = {
    "index-url": ("UV_DEFAULT_INDEX", ""),
    "extra-index-url": ("UV_INDEX", " "),
    "find-links": ("UV_FIND_LINKS", ","),
    "trusted-host": ("UV_INSECURE_HOST", " "),
    "no-index": ("UV_NO_INDEX", ""),
    "no-cache-dir": ("UV_NO_CACHE", ""),
    "timeout": ("UV_HTTP_TIMEOUT", ""),
    "default-timeout": ("UV_HTTP_TIMEOUT", ""),
    "cert": ("SSL_CERT_FILE", ""),
    "client-cert": ("SSL_CLIENT_CERT", ""),
    "proxy": ("ALL_PROXY", ""),
}
# They cannot change which files come, as the lock names each by its version and hash, nor where from.
NO_MATTER = frozenset(
    [
        "constraint",
        "disable-pip-version-check",
        "no-input",
        "no-color",
        "progress-bar",
        "quiet",
        "verbose",
        "log",
        "retries",
        "cache-dir",
        "require-virtualenv",
        "root-user-action",
        "break-system-packages",
        "compile",
        "no-compile",
        "no-deps",
        "no-warn-script-location",
        "no-python-version-warning",
        "require-hashes",
    ]
)
OFF = ("", "0", "false", "no", "off")


def uv_variables(listed: str, present: Mapping[str, str]) -> dict[str, str] | str:
    """Return the variables that make uv find packages where pip does; what says so already wins.

    listed: output of ``pip config list``. present: variables of this process. A text is the option
    of pip for which uv has no equal: pip has to do it then.
    """
    settings: dict[str, str] = {}
    # Later ones win, as in pip: files, their section for `install`, variables.
    for section in ("global", "install", ":env:"):
        for line in listed.splitlines():
            name, found, value = line.partition("=")
            place, dot, option = name.rpartition(".")
            if found and dot and place.rstrip(".") == section:
                try:
                    settings[option.replace("_", "-")] = str(ast.literal_eval(value))
                except (SyntaxError, ValueError):
                    return option
    settings.pop("config-file", None)  # where pip reads the others
    # pip takes the best version of all indexes; uv otherwise that of the first that has any.
    variables = {"UV_INDEX_STRATEGY": "unsafe-best-match"}
    for option, value in settings.items():
        if option in NO_MATTER:
            continue
        if option not in SAME:
            return option
        variable, between = SAME[option]
        if option in ("no-index", "no-cache-dir"):
            value = "" if value.strip().lower() in OFF else "1"
        if value.strip():
            variables[variable] = between.join(value.split()) if between else value.strip()
    return {name: value for name, value in variables.items() if name not in present}
