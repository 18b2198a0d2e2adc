#!/bin/sh
# The command `decanter` of the package. Root acts as the service's user, so that what a command makes (accounts, keys,
# models) is the service's too; who it was for the audit log stays known.
set -eu
program=/usr/lib/decanter/bin/decanter
if [ "$(id -u)" -ne 0 ]; then
    exec "$program" "$@"
fi
export DECANTER_BY="${DECANTER_BY:-${SUDO_USER:-root}}"
export HOME=/var/lib/decanter
exec setpriv --reuid=decanter --regid=decanter --init-groups "$program" "$@"
