/* What a master needs for few positions, announced contact and codecs that follow the hand. */
#include "hapticnet.h"

size_t hn_more_bytes(const hn_request *request)
{
    (void)request;
    return 0;
}

struct hn_more *hn_more_init(void *memory, const hn_request *request)
{
    (void)memory;
    (void)request;
    return NULL;
}
