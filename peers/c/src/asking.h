/* How a master asks for a session and begins it: docs/refer/protocol.md, "Asking". */
#ifndef HN_ASKING_H
#define HN_ASKING_H

#include "messages.h"

uint32_t hn_version(const hn_master *m); /* of its sessions: 2 if they are sealed */
const char *hn_take_settings(const hn_request *request, hn_settings *s);
unsigned hn_stream_index(const hn_master *m, const hn_stream *s);

void hn_ask(hn_master *m); /* unless it is asking */
void hn_stop_asking(hn_master *m);
void hn_tick_asking(hn_master *m, int64_t now_us);
size_t hn_send_hello(const hn_master *m, uint8_t *data);

void hn_receive_cookie(hn_master *m, const hn_frame *frame, int64_t now_us);
void hn_receive_welcome(hn_master *m, const hn_frame *frame, int64_t now_us);
void hn_receive_refuse(hn_master *m, const hn_frame *frame, int64_t now_us);

void hn_note_reason(hn_master *m, const hn_ending *ending);
void hn_end(hn_master *m);

#endif
