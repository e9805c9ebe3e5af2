/* embed.h - a file of the source tree inside the program. */
#ifndef RESULT_EMBED_H
#define RESULT_EMBED_H

/* extern const char SYMBOL[], SYMBOL_size bytes. path: from the root. The Makefile rebuilds the
 * object when firmware/web changes. Hidden: for other symbols gcc on Arm asks the linker for an
 * entry of the GOT, which it makes for the start of the section only. */
#define EMBED_FILE(symbol, path)                                                                   \
    extern __attribute__((visibility("hidden"))) const char symbol[];                              \
    extern __attribute__((visibility("hidden"))) const unsigned symbol##_size;                     \
    __asm__(".pushsection .rodata\n" #symbol ":\n.incbin \"" path "\"\n1:\n.balign 4\n" #symbol    \
            "_size:\n.4byte 1b - " #symbol "\n.popsection\n")

#endif
