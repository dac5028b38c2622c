/* What sketches on portable_scan.h use of Arduino's functions: for a program on this computer, see portable.cpp. */
#ifndef ARDUINO_H
#define ARDUINO_H

#include <math.h>
#include <stddef.h>
#include <stdint.h>

enum { LOW, HIGH, OUTPUT, A0 = 54 };

void pinMode(uint8_t pin, uint8_t mode);
void digitalWrite(uint8_t pin, uint8_t level);
void analogReadResolution(int bits);
int analogRead(uint8_t pin);
void delayMicroseconds(unsigned microseconds);
uint32_t micros();
uint32_t millis();

struct SerialLine {
    void begin(long baud);
    int available();
    int read();
    size_t write(uint8_t byte);
    void print(const char *text);
    void print(char sign);
    void print(long number);
    void print(double number, int digits);
    void print(int number) { print((long)number); }
    void println(const char *text) { print(text), print("\r\n"); }
    void println(double number, int digits) { print(number, digits), print("\r\n"); }
};
extern SerialLine Serial;

void setup();
void loop();

#endif
