#!/bin/sh
# Layout and length. A function reaches from an opening to a closing brace in column 1. Inner loops
# have up to 8 parameters, which fit into registers; a struct would have to go through memory.
files=$(find core drivers firmware sim tests board .ci Makefile -type f 2>/dev/null |
    grep -v -e '^tests/data/' -e '^tests/fuzz/corpus/' -e '\.safetensors$' -e '\.md$' \
        -e '\.pyc$' | sort)
code=$(echo "$files" | grep '\.[ch]$')
bad=0

for f in $files; do
    [ ! -s "$f" ] || [ -z "$(tail -c 1 "$f")" ] || { echo "$f: no newline at the end"; bad=1; }
done
LC_ALL=C grep -n "$(printf '[^ -~\t]')" $files && { echo "^ not plain ASCII"; bad=1; }
grep -n '[[:space:]]$' $files && { echo "^ blank at the end of the line"; bad=1; }
grep -n "$(printf '\t')" $(echo "$files" | grep -v '^Makefile$') && { echo "^ tab"; bad=1; }
grep -nwiE '(TO[D]O|FI[X]ME|X[X]X|st[u]b|place[h]older)s?' $files && { echo "^ unfinished"; bad=1; }
grep -nE '^typedef [^(]*\*[ a-z_0-9]+;' $code && { echo "^ typedef of a pointer"; bad=1; }
grep -nE '^ {16,}(if|for|while|switch|do)\b' $code && { echo "^ nested deeper than three"; bad=1; }

awk '
FNR == 1 { signature = ""; start = 0 }
length($0) > 100 { complain(FNR, length($0) " columns, at most 100") }
FNR == 801 { complain(FNR, "more than 800 lines") }
FILENAME !~ /\.[ch]$/ { next }
/^([a-z]|MAP ).*\(/ && !/;$/ { signature = $0; line = FNR; next }
/^[ ]+.*\)$/ && signature != "" && !start { signature = signature $0; next }
/^{/ && signature != "" { start = FNR; check_signature(); next }
/^}/ && start {
    if (FNR - start - 1 > 60)
        complain(line, "function of " FNR - start - 1 " lines, at most 60")
    start = 0
    signature = ""
}
function check_signature(i, c, depth, commas, most) {
    most = FILENAME ~ /^core\/kernels\/[a-z0-9]+_body\.h$/ ? 8 : 6
    commas = 0
    depth = 0
    for (i = 1; i <= length(signature); i++) {
        c = substr(signature, i, 1)
        depth += (c == "(") - (c == ")")
        commas += c == "," && depth == 1
    }
    if (commas >= most)
        complain(line, commas + 1 " parameters, at most " most)
}
function complain(n, what) { print FILENAME ":" n ": " what; bad = 1 }
END { exit bad }' $files || bad=1
exit $bad
