#!/bin/sh
# sysroot.sh ARCH FOLDER PACKAGE... - libraries and headers of another architecture for a cross
# build, with all that they depend on. They come from the sources of packages of this machine; none
# is installed here, where the -dev packages of two architectures exclude each other.
# FOLDER gets a database for dpkg-shlibdeps: every file by its path on this machine.
# Packages that are there already are not fetched again.
set -eu
arch=$1 root=$2
shift 2
[ "$*" != "$(cat "$root/packages" 2>/dev/null)" ] || { touch "$root/packages"; exit 0; }

echo "libraries for $arch: $root"
rm -rf "$root"
mkdir -p "$root/apt/lists/partial" "$root/apt/archives/partial" "$root/var/lib/dpkg/info" \
    "$root/usr/lib"
ln -s usr/lib "$root/lib"
root=$(cd "$root" && pwd)
db=$root/var/lib/dpkg
touch "$db/status"
cat >"$root/apt/conf" <<END
APT::Architecture "$arch";
APT::Architectures { "$arch"; };
APT::Sandbox::User "root";
Dir::State "$root/apt";
Dir::State::status "$db/status";
Dir::Cache "$root/apt";
END
export APT_CONFIG="$root/apt/conf"
apt-get -qq update
apt-get -qq install -y --download-only --no-install-recommends "$@"

echo 1 >"$db/info/format" # the names of files have the architecture
for deb in "$root"/apt/archives/*.deb; do
    dpkg-deb --fsys-tarfile "$deb" >"$root/files"
    tar -x --keep-directory-symlink -C "$root" -f "$root/files"
    name=$(dpkg-deb -f "$deb" Package)
    [ "$(dpkg-deb -f "$deb" Multi-Arch)" != same ] || name=$name:$arch
    { dpkg-deb -f "$deb" && printf 'Status: install ok installed\n\n'; } >>"$db/status"
    tar -t -f "$root/files" | sed "s|^\./lib/|./usr/lib/|; s|^\.|$root|; s|/$||" \
        >"$db/info/$name.list"
    for file in symbols shlibs; do
        dpkg-deb -I "$deb" $file >"$db/info/$name.$file" 2>/dev/null || rm "$db/info/$name.$file"
    done
done
# Absolute links stay inside.
find "$root" -type l -lname '/*' | while read -r link; do
    ln -sfn "$(realpath -m --relative-to="${link%/*}" "$root$(readlink "$link")")" "$link"
done
rm -rf "$root/apt" "$root/files"
echo "$*" >"$root/packages"
