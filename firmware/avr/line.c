/* USART0 with two ring buffers; each has one writer and one reader, so the indices need no lock. */
#include <avr/interrupt.h>
#include <avr/io.h>

#include "board.h"

#define RX_SIZE 128u /* 2.5 ms at 500 kbaud */
#define TX_SIZE 128u

static volatile uint8_t rx[RX_SIZE], rx_head, rx_tail, overruns;
static volatile uint8_t tx[TX_SIZE], tx_head, tx_tail;

void line_start(void)
{
    UCSR0A = 0;
    UBRR0 = 1; /* 500 kbaud, exactly */
    UCSR0C = _BV(UCSZ01) | _BV(UCSZ00);
    UCSR0B = _BV(RXEN0) | _BV(TXEN0) | _BV(RXCIE0);
}

ISR(USART_RX_vect)
{
    uint8_t status = UCSR0A;
    uint8_t byte = UDR0;
    uint8_t head = rx_head;
    uint8_t next = (head + 1u) % RX_SIZE;
    if (next == rx_tail) {
        overruns++;
    } else {
        rx[head] = byte;
        rx_head = next;
    }
    if (status & _BV(DOR0))
        overruns++;
}

ISR(USART_UDRE_vect)
{
    uint8_t tail = tx_tail;
    if (tail == tx_head) {
        UCSR0B &= (uint8_t)~_BV(UDRIE0);
    } else {
        UDR0 = tx[tail];
        tx_tail = (tail + 1u) % TX_SIZE;
    }
}

bool line_is_empty(void)
{
    return rx_head == rx_tail;
}

bool line_take(uint8_t *byte)
{
    uint8_t tail = rx_tail;
    if (tail == rx_head)
        return false;
    *byte = rx[tail];
    rx_tail = (tail + 1u) % RX_SIZE;
    return true;
}

void line_send(const uint8_t *bytes, uint8_t length)
{
    uint8_t head = tx_head;
    uint8_t room = (uint8_t)(tx_tail - head - 1u) % TX_SIZE;
    if (length == 0 || length > room)
        return;
    while (length--) {
        tx[head] = *bytes++;
        head = (head + 1u) % TX_SIZE;
    }
    tx_head = head;
    UCSR0B |= _BV(UDRIE0);
}

uint8_t line_overruns(void)
{
    return overruns;
}
