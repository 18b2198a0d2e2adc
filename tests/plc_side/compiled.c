/* The function block as matiec has compiled it, on a clock of the test's own: commands on stdin, an account on stdout.
   p N: the permit; w BLOCK OFFSET COUNT WORDS...: words of a block's area; c COUNT: so many cycles; a BLOCK: the PLC's
   account of it. MAIN is the program's instance; BLOCKS and ACCOUNTS are where the gateway writes and the PLC answers. */
#include <stdio.h>
#include <string.h>
#include "accessor.h"
#include "iec_std_lib.h"
#include "POUS.h"

TIME __CURRENT_TIME;
extern GATEWAY_BLOCK_MAIN MAIN;
void config_init__(void);
void config_run__(unsigned long tick);

static WORD I_words[65536], Q_words[65536], M_words[65536];
#define __LOCATED_VAR(type, name, area, size, index, ...) type *name = (type *)&area##_words[index];
#include "LOCATED_VARIABLES.h"
#undef __LOCATED_VAR

enum { ACCOUNT_WORDS = 7, CYCLE_MS = 20 };

int main(void) {
    WORD *const blocks[] = {BLOCKS}, *const accounts[] = {ACCOUNTS};
    unsigned long tick = 0;
    char command;
    config_init__();
    while (scanf(" %c", &command) == 1) {
        int block = 0, first = 0, count = 0, word = 0;
        if (command == 'p' && scanf("%d", &count) == 1) {
            MAIN.PERMITSWITCH.value = count != 0;
        } else if (command == 'w' && scanf("%d %d %d", &block, &first, &count) == 3) {
            for (int place = 0; place < count && scanf("%d", &word) == 1; place++)
                blocks[block][first + place] = (WORD)word;
        } else if (command == 'c' && scanf("%d", &count) == 1) {
            while (count-- > 0) {
                unsigned long ms = ++tick * CYCLE_MS;
                __CURRENT_TIME.tv_sec = (long)(ms / 1000);
                __CURRENT_TIME.tv_nsec = (long)(ms % 1000) * 1000000L;
                config_run__(tick);
            }
        } else if (command == 'a' && scanf("%d", &block) == 1) {
            for (int place = 0; place < ACCOUNT_WORDS; place++)
                printf("%d ", accounts[block][place]);
            printf("\n");
            fflush(stdout);
        }
    }
    return 0;
}
