/* Runs estimate_on_mega/main.c on libsimavr's ATmega2560: the cycles of each frame, then the log changes of the last one.
 *
 * Links libsimavr, which is under the GNU General Public License, version 3: this program is built where it is used and
 * is never distributed in binary form with lampest.
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "sim_avr.h"
#include "sim_elf.h"

/* Data space of an ATmega2560: datasheet, register summary. */
#define GPIOR0_ADDRESS 0x3E
#define GPIOR1_ADDRESS 0x4A
#define GPIOR2_ADDRESS 0x4B
#define BROKEN 255

int main(int count, char **words) {
    elf_firmware_t firmware;
    memset(&firmware, 0, sizeof firmware);
    if (count != 4 || elf_read_firmware(words[1], &firmware)) return 2;
    const int frames = atoi(words[2]), cells = atoi(words[3]);
    avr_t *avr = avr_make_mcu_by_name("atmega2560");
    if (!avr) return 2;
    avr_init(avr);
    firmware.frequency = 16000000;
    avr_load_firmware(avr, &firmware);
    avr->log = LOG_NONE;
    avr_cycle_count_t began = 0;
    for (int seen = 0; seen <= frames;) {
        const int state = avr_run(avr);
        if (state == cpu_Done || state == cpu_Crashed) return 3;
        const int now = avr->data[GPIOR0_ADDRESS];
        if (now == BROKEN) return 4;
        if (now == seen) continue;
        if (seen) printf("%llu\n", (unsigned long long)(avr->cycle - began));
        began = avr->cycle, seen = now;
    }
    const uint8_t *change = avr->data + (avr->data[GPIOR1_ADDRESS] | avr->data[GPIOR2_ADDRESS] << 8);
    for (int cell = 0; cell < cells; cell++) {
        float value;
        memcpy(&value, change + 4 * cell, sizeof value);
        printf("%.7g ", value);
    }
    printf("\n");
    return 0;
}
