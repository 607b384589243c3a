/* Lets User-Mode Linux 6.1 run on a processor with more registers than its 2,696 bytes hold (AMX).
 *
 * The host's kernel takes the registers of a traced process only whole (PTRACE_SETREGSET with
 * NT_X86_XSTATE), and User-Mode Linux ends with a panic when its shorter ones are refused. Preloaded,
 * this completes them with what the process has. Newer kernels ask for the size. */
#define _GNU_SOURCE
#include <elf.h>
#include <stdarg.h>
#include <string.h>
#include <sys/ptrace.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <unistd.h>

static char whole[16384];

long ptrace(enum __ptrace_request request, ...)
{
    va_list rest;
    va_start(rest, request);
    long pid = va_arg(rest, long);
    void *address = va_arg(rest, void *), *data = va_arg(rest, void *);
    va_end(rest);
    long peeked, result;
    if (request == PTRACE_SETREGSET && (long)address == NT_X86_XSTATE) {
        struct iovec all = {whole, sizeof whole}, *part = data;
        if (syscall(SYS_ptrace, PTRACE_GETREGSET, pid, address, &all) == 0
            && part->iov_len < all.iov_len) {
            memcpy(whole, part->iov_base, part->iov_len);
            return syscall(SYS_ptrace, request, pid, address, &all);
        }
    }
    if (request == PTRACE_PEEKTEXT || request == PTRACE_PEEKDATA || request == PTRACE_PEEKUSER) {
        result = syscall(SYS_ptrace, request, pid, address, &peeked);
        return result < 0 ? result : peeked;
    }
    return syscall(SYS_ptrace, request, pid, address, data);
}
