/* Counts the allocations of the interpreter in the thread that asks: `count_allocations`, then `allocations`. */
#include <stddef.h>

typedef struct {
    void *context;
    void *(*malloc)(void *, size_t);
    void *(*calloc)(void *, size_t, size_t);
    void *(*realloc)(void *, void *, size_t);
    void (*free)(void *, void *);
} Allocator;

enum { MEM = 1, OBJ = 2 };
void PyMem_GetAllocator(int domain, Allocator *allocator);
void PyMem_SetAllocator(int domain, Allocator *allocator);

static Allocator before[3];
static __thread long count;
static __thread int counts;

static void *counted_malloc(void *context, size_t size)
{
    Allocator *other = context;
    count += counts;
    return other->malloc(other->context, size);
}

static void *counted_calloc(void *context, size_t number, size_t size)
{
    Allocator *other = context;
    count += counts;
    return other->calloc(other->context, number, size);
}

static void *counted_realloc(void *context, void *memory, size_t size)
{
    Allocator *other = context;
    count += counts;
    return other->realloc(other->context, memory, size);
}

static void counted_free(void *context, void *memory)
{
    Allocator *other = context;
    other->free(other->context, memory);
}

void count_allocations(void)
{
    for (int domain = MEM; domain <= OBJ; domain++) {
        PyMem_GetAllocator(domain, &before[domain]);
        Allocator own = {&before[domain], counted_malloc, counted_calloc, counted_realloc, counted_free};
        PyMem_SetAllocator(domain, &own);
    }
    counts = 1;
}

long allocations(void)
{
    counts = 0;
    return count;
}
