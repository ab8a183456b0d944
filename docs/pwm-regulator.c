/* Analogue pressure regulators behind the PWM outputs of a microcontroller, told over a serial line: the firmware's part
 * that does not depend on the board. docs/pwm-regulator.md has the protocol and the wiring; tests/devices/pwm.rs runs this
 * file against the driver.
 *
 * The board calls pwm_setup() once, pwm_byte() for every byte that comes, and pwm_poll() as often as it can, and has its
 * own hardware watchdog reset it when that stops. It gives the three functions below. */
#include <stdint.h>
#include <stdio.h>
#include <string.h>

#define FIRST_ID 'A'    /* the first output's; the others follow */
#define OUTPUTS 4
#define WATCHDOG_MS 250 /* 100 to 1000 */

void board_pwm(uint8_t output, uint16_t duty); /* 0 to 4095 of 4095 */
void board_send(const char *text);
uint32_t board_millis(void);

static struct {
    uint16_t duty;
    uint32_t told; /* when, ms */
    char state;    /* how things stood before the next command */
} outputs[OUTPUTS];

static char line[24];
static uint8_t length;

static void put(uint8_t output, uint16_t duty) {
    outputs[output].duty = duty;
    outputs[output].told = board_millis();
    board_pwm(output, duty);
}

static uint8_t crc(const char *text) {
    uint8_t crc = 0;
    for (; *text; text++) {
        crc ^= (uint8_t)*text;
        for (uint8_t bit = 0; bit < 8; bit++)
            crc = crc & 0x80 ? (uint8_t)(crc << 1 ^ 0x07) : (uint8_t)(crc << 1);
    }
    return crc;
}

static int is_digit(char c) { return c >= '0' && c <= '9'; }

/* `line` is `A07 0800*D3` or `A08 V*B8`; whatever else is not answered. */
static void carry_out(void) {
    char check[3], text[16], answer[24];
    char *star = strrchr(line, '*');
    if (!star || star - line < 5 || strlen(star) != 3)
        return;
    *star = 0;
    snprintf(check, sizeof check, "%02X", crc(line));
    if (strcmp(check, star + 1) != 0 || !is_digit(line[1]) || !is_digit(line[2]) || line[3] != ' ')
        return;
    if (line[0] < FIRST_ID || line[0] >= FIRST_ID + OUTPUTS)
        return;
    uint8_t output = (uint8_t)(line[0] - FIRST_ID);
    const char *what = line + 4;
    if (strcmp(what, "V") == 0) {
        snprintf(text, sizeof text, "PWM1 %04d", WATCHDOG_MS);
    } else {
        uint16_t duty = 0;
        if (strlen(what) != 4)
            return;
        for (uint8_t i = 0; i < 4; i++) {
            if (!is_digit(what[i]))
                return;
            duty = (uint16_t)(10 * duty + (what[i] - '0'));
        }
        if (duty > 4095)
            return;
        put(output, duty);
        snprintf(text, sizeof text, "%04u%c", duty, outputs[output].state);
        outputs[output].state = '=';
    }
    snprintf(answer, sizeof answer, "%.4s%s", line, text);
    snprintf(check, sizeof check, "%02X", crc(answer));
    board_send(answer);
    board_send("*");
    board_send(check);
    board_send("\r");
}

void pwm_setup(void) {
    for (uint8_t output = 0; output < OUTPUTS; output++) {
        put(output, 0);
        outputs[output].state = 'R';
    }
}

void pwm_byte(char byte) {
    if (byte == '\r') {
        line[length] = 0;
        if (length < sizeof line - 1)
            carry_out();
        length = 0;
    } else if (length < sizeof line - 1) {
        line[length++] = byte;
    }
}

void pwm_poll(void) {
    for (uint8_t output = 0; output < OUTPUTS; output++)
        if (outputs[output].duty && board_millis() - outputs[output].told > WATCHDOG_MS) {
            put(output, 0);
            outputs[output].state = 'W';
        }
}
