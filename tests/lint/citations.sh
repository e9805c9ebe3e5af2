#!/bin/sh
# Every file that a comment or a document cites is in the repository, under its path from the root,
# and so is every section: `core/net/README.md 2.7` needs a heading "### 2.7 ..." there.
# In comments and documents a name without folder is that of some file of ours.
files=$(find core drivers firmware sim board tests .ci Makefile README.md -name __pycache__ -prune \
    -o -type f -print | sort)
# Of other programs: Linux, libcamera, Pillow, Python, COLMAP, InstantHDR; system headers of ours.
foreign='gpiolib-cdev.c irq_sim.c gpio-sim.c gpiolib.h uvc_video.c dm-log-writes.c user-offsets.c
    irq.h merge_config.sh prctl.h format.html delayed_controls.cpp camera_sensor_properties.cpp
    Resample.c pickletools.py models.h simple_trainer_hdr.py videodev2.h gpio.h zip.h
    zstd_errors.h sysexits.h encoder.c logf.c libcamera.h'

echo "$files" | awk -v foreign="$foreign" '
BEGIN {
    path_pattern = "[A-Za-z0-9_./-]+[.](c|h|cpp|hpp|md|sh|bash|py|js|css|html)" \
        "([^A-Za-z0-9_./(*-]|[.][^A-Za-z]|[.]?$)"
    folder_pattern = "(^|[^A-Za-z0-9_./-])(core|drivers|firmware|sim|board|tests)" \
        "(/[a-z0-9_]+)+([^A-Za-z0-9_./*<-]|[.] |[.]?$)"
    n = split(foreign, list, /[ \n]+/)
    for (i = 1; i <= n; i++)
        other[list[i]] = 1
    while ((getline < "-") > 0) {
        file[++files] = $0
        known[$0] = 1
        base = $0
        sub(/.*\//, "", base)
        named[base] = 1
        for (base = $0; sub(/\/[^\/]*$/, "", base);)
            known[base] = 1
        base = $0
        sub(/\.[a-z0-9]+$/, "", base)
        known[base] = 1
    }
    for (i = 1; i <= files; i++)
        if (file[i] ~ /\.md$/)
            read_headings(file[i])
    for (i = 1; i <= files; i++)
        if (file[i] ~ /\.(c|h|cpp|hpp|md|py|sh|bash|conf)$|^Makefile$/)
            check_file(file[i])
    exit bad
}
function read_headings(f, line) {
    while ((getline line < f) > 0)
        if (match(line, /^##+ [0-9]+(\.[0-9]+)?/)) {
            sub(/^#+ /, "", line)
            match(line, /^[0-9]+(\.[0-9]+)?/)
            heading[f, substr(line, 1, RLENGTH)] = 1
        }
    close(f)
}
function check_file(f, line, row, inside, text, fence) {
    row = inside = fence = 0
    while ((getline line < f) > 0) {
        row++
        at = f ":" row
        text = line
        if (f ~ /\.(c|h|cpp|hpp)$/) {
            text = ""
            if (inside || match(line, /\/\*/)) {
                text = inside ? line : substr(line, RSTART)
                inside = text !~ /\*\//
            } else if (match(line, /\/\/ /))
                text = substr(line, RSTART)
        } else if (f ~ /\.(sh|bash|conf)$|Makefile$/)
            text = match(line, /(^|[ \t])# /) ? substr(line, RSTART) : ""
        check_text(f, text)
    }
    close(f)
}
function check_text(f, text, path, rest, before) {
    if (f != "tests/lint/citations.sh" && tolower(text) ~ /model-spec|capture notes|house rule/)
        complain("cites a document that is not in the repository")
    gsub(/https?:[^ )>]*/, "", text)
    check_folders(text)
    while (match(text, path_pattern)) {
        path = substr(text, RSTART, RLENGTH)
        before = RSTART > 1 ? substr(text, RSTART - 1, 1) : ""
        text = substr(text, RSTART + RLENGTH)
        last = substr(path, length(path))
        sub(/[^A-Za-z0-9]+$/, "", path)
        if (before ~ /[<*>]/ || path ~ /^[.\/]/ || is_pattern(path))
            continue
        check_path(f, path)
        if (path ~ /README\.md$/ && (path in known))
            check_sections(path, last text)
    }
}
# As in NAME_test.c, GROUP_ISA.c, FOLDER/README.md.
function is_pattern(path, part, n, i) {
    n = split(path, part, /\//)
    for (i = 1; i < n; i++)
        if (part[i] ~ /[A-Z]/)
            return 1
    return part[n] ~ /[A-Z][A-Z]/ && part[n] !~ /^(README|MODEL)\.md$/
}
# Folders, and files without their ending.
function check_folders(text, path) {
    while (match(text, folder_pattern)) {
        path = substr(text, RSTART, RLENGTH)
        text = substr(text, RSTART + RLENGTH - 1)
        gsub(/^[^a-z]|[^a-z0-9_]+$/, "", path)
        if (!(path in known))
            complain("no folder or file " path)
    }
}
function check_path(f, path, base, folder) {
    base = folder = path
    sub(/.*\//, "", base)
    sub(/[^\/]*$/, "", folder)
    if ((path in known) || (base in other))
        return
    if (folder == "" && (base in named))
        return
    if (folder == "" && f !~ /\.md$/ && base !~ /_/)
        return # a member of a struct, as in frame.h
    complain("no file " path)
}
function check_sections(path, text, number) {
    sub(/^`/, "", text)
    if (text !~ /^ [0-9]/)
        return
    while (match(text, /^(,| and| to)? ?[0-9]+(\.[0-9]+)?/)) {
        number = substr(text, RSTART, RLENGTH)
        text = substr(text, RSTART + RLENGTH)
        sub(/^[^0-9]*/, "", number)
        if (!((path, number) in heading))
            complain(path " has no section " number)
    }
}
function complain(what) { print at ": " what; bad = 1 }
' || exit 1
