#!/bin/sh
# Run "hapticnet slave …" or "hapticnet master …" with keys that are made at the first start. Each side keeps its private
# key in its own volume, /keys, and leaves its public key in the volume that both share, /public. Whoever can write to
# /public can become a master of this slave: between two hosts, carry the public keys by hand (docs/understand/security.md).
set -eu
role=$1
case $role in
    slave) peer=master ;;
    master) peer=slave ;;
    *) echo "with-keys: the first argument is '$role'; it must be slave or master" >&2; exit 2 ;;
esac

trap 'exit 143' TERM  # process 1 ignores it otherwise, and "docker stop" would wait while the peer is awaited

export HAPTICNET_KEY=/keys/key.toml
if ! [ -e "$HAPTICNET_KEY" ]; then
    said=$(hapticnet key new "$HAPTICNET_KEY" 2>&1) || { echo "$said" >&2; exit 2; }
fi
hapticnet key public "$HAPTICNET_KEY" >"/public/.$role"
mv "/public/.$role" "/public/$role"
until [ -s "/public/$peer" ]; do sleep 0.2; done

if [ "$role" = slave ]; then
    export HAPTICNET_MASTERS=/keys/masters.toml
    printf '[[master]]\nname = "master"\npublic = "%s"\n' "$(cat /public/master)" >"$HAPTICNET_MASTERS"
else
    HAPTICNET_PEER_KEY=$(cat /public/slave)
    export HAPTICNET_PEER_KEY
fi
exec hapticnet "$@"
