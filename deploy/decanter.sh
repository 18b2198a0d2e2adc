#!/bin/sh
# The command `decanter` of the package. Root acts as the service's user, so that what a command makes (accounts, keys,
# models) is the service's too; who it was for the audit log stays known.
set -eu
program=/usr/lib/decanter/bin/decanter
if [ "$(id -u)" -ne 0 ]; then
    exec "$program" "$@"
fi
export DECANTER_BY="${DECANTER_BY:-${SUDO_USER:-root}}"
export DECANTER_RECORDS="${DECANTER_RECORDS:-/var/lib/decanter/commissioning.jsonl}"
export HOME=/var/lib/decanter
as_service="setpriv --reuid=decanter --regid=decanter --init-groups"
if ! $as_service test -x .; then
    echo "decanter: works in /etc/decanter: the user decanter may not look into this folder" >&2
    cd /etc/decanter
fi
exec $as_service "$program" "$@"
