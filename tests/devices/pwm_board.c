/* The firmware of docs/pwm-regulator.c on this computer: its line is what stands at 0, its duties go to 2. */
#include "../../docs/pwm-regulator.c"

#include <poll.h>
#include <time.h>
#include <unistd.h>

void board_pwm(uint8_t output, uint16_t duty) {
    char text[16];
    int count = snprintf(text, sizeof text, "%c %u\n", FIRST_ID + output, duty);
    if (write(2, text, (size_t)count) != count)
        _exit(1);
}

void board_send(const char *text) {
    if (write(0, text, strlen(text)) < 0)
        _exit(1);
}

uint32_t board_millis(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (uint32_t)((uint64_t)now.tv_sec * 1000 + (uint64_t)now.tv_nsec / 1000000);
}

int main(void) {
    pwm_setup();
    for (;;) {
        struct pollfd in = {.fd = 0, .events = POLLIN};
        char byte;
        if (poll(&in, 1, 5) > 0 && in.revents & POLLIN && read(0, &byte, 1) == 1)
            pwm_byte(byte);
        else if (in.revents) /* nobody has the other end open */
            nanosleep(&(struct timespec){.tv_nsec = 5000000}, NULL);
        pwm_poll();
    }
}
