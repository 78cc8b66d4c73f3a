# cophase as a C library: `make`, then `make install PREFIX=/usr/local` (DESTDIR for packagers), `make uninstall`.
# docs/c.md says how to use what is installed. For Linux and the GNU binutils.
#
# One compilation makes both libraries: rustc's archive is linked into a single object whose only global symbols are the
# header's functions, the static library is that object, and the shared library is linked from it. So both hold the same
# code, neither can clash with a program's own copy of what is inside (CFITSIO, Rust's runtime), and any build of the
# archive can be installed: `make install ARCHIVE=target/debug/libcophase.a` takes one as it is.

PREFIX ?= /usr/local
# Absolute, for what is written into cophase.pc.
override PREFIX := $(abspath $(PREFIX))
LIBDIR ?= $(PREFIX)/lib
INCLUDEDIR ?= $(PREFIX)/include
DATADIR ?= $(PREFIX)/share
override LIBDIR := $(abspath $(LIBDIR))
override INCLUDEDIR := $(abspath $(INCLUDEDIR))
override DATADIR := $(abspath $(DATADIR))
# With link-time optimisation; `make check-lto` proves it. `PROFILE=dev` compiles faster, for trying things out.
PROFILE ?= release-lto
CARGO ?= cargo
CARGOFLAGS ?= --locked
OBJCOPY ?= objcopy
INSTALL ?= install

# Cargo.toml and src/capi/version.rs are the homes of the two versions.
VERSION := $(shell sed -n 's/^version = "\(.*\)"$$/\1/p' Cargo.toml | head -n 1)
ABI := $(shell sed -n 's/^pub const COPHASE_ABI_VERSION: u32 = \([0-9]*\);$$/\1/p' src/capi/version.rs)
ifneq ($(words $(VERSION) $(ABI)), 2)
$(error no version in Cargo.toml ("$(VERSION)"), or none of the interface in src/capi/version.rs ("$(ABI)"))
endif

# What the archive needs of the system, as `rustc --print native-static-libs` has it, but for OpenCL, which is opened at
# run time; `-z defs` below holds it to that.
NATIVE_LIBRARIES := gcc_s util rt pthread m dl c

TARGET_DIR := $(or $(CARGO_TARGET_DIR),target)
PROFILE_DIR := $(TARGET_DIR)/$(if $(filter dev,$(PROFILE)),debug,$(PROFILE))
BUILD ?= $(PROFILE_DIR)/c

SONAME := libcophase.so.$(ABI)
SHARED := libcophase.so.$(VERSION)
PC_FILES := cophase.pc cophase-static.pc
CMAKE_FILES := cophase-config.cmake cophase-config-version.cmake
BUILT := $(addprefix $(BUILD)/,$(SHARED) libcophase.a)

PKGCONFIGDIR := $(LIBDIR)/pkgconfig
CMAKEDIR := $(LIBDIR)/cmake/cophase

.PHONY: all install uninstall check-lto
.DELETE_ON_ERROR:
all: $(BUILT)

ifndef ARCHIVE
ARCHIVE := $(PROFILE_DIR)/libcophase.a
# The library alone, and of its kinds the archive alone: beside an rlib cargo drops `lto` without a word. Where nothing
# has changed cargo is not called, so that `sudo make install` needs no Rust. cargo leaves a file that needs no change as
# old as it is.
$(ARCHIVE): Cargo.toml Cargo.lock build.rs $(shell find src kernels $(wildcard numerics) -type f)
	$(CARGO) rustc $(CARGOFLAGS) --target-dir $(TARGET_DIR) --profile $(PROFILE) --lib --crate-type staticlib
	@touch $@
endif

$(BUILD):
	mkdir -p $@

HEADERS := include/cophase.h include/cophase_simulator.h
# Every key of a scene, as `cophase scene --reference` prints it.
REFERENCE := include/scene-reference.txt

# The functions of the headers: without comments, names before a parenthesis.
$(BUILD)/symbols: $(HEADERS) Makefile | $(BUILD)
	$(CC) -E -P include/cophase_simulator.h | grep -o '\bcophase_[a-z0-9_]*(' | tr -d '(' | sort -u >$@

# Out of the archive what the functions need; debugging information and the bitcode of Rust's own libraries stay behind,
# names for backtraces do not.
$(BUILD)/cophase.o: $(ARCHIVE) $(BUILD)/symbols Makefile
	$(LD) -r --gc-sections --strip-debug $$(sed 's/^/-u /' $(BUILD)/symbols) -o $@ $(ARCHIVE)
	$(OBJCOPY) --remove-section=.llvmbc --remove-section=.llvmcmd --keep-global-symbols=$(BUILD)/symbols $@

$(BUILD)/libcophase.a: $(BUILD)/cophase.o
	rm -f $@
	$(AR) rcs $@ $<

# Complete in itself, no relocations in code that processes share, symbols bound when it is loaded: a first call of a
# real-time thread does not meet the dynamic linker.
$(BUILD)/$(SHARED): $(BUILD)/cophase.o
	$(CC) -shared -Wl,-soname,$(SONAME) -Wl,-z,defs,-z,text,-z,relro,-z,now $(LDFLAGS) -o $@ $< \
		$(addprefix -l,$(NATIVE_LIBRARIES))

# The templates of bindings/c, filled in; paths below the prefix are given from it, so that pkg-config can move them.
FILL := sed -e 's|@VERSION@|$(VERSION)|g' -e 's|@PREFIX@|$(PREFIX)|g' -e 's|@SONAME@|$(SONAME)|g' \
	-e 's|@LIBDIR@|$(patsubst $(PREFIX)/%,$${prefix}/%,$(LIBDIR))|g' \
	-e 's|@INCLUDEDIR@|$(patsubst $(PREFIX)/%,$${prefix}/%,$(INCLUDEDIR))|g' \
	-e 's|@INCLUDE_FROM_LIBDIR@|$(shell realpath -m --relative-to=$(LIBDIR) $(INCLUDEDIR))|g' \
	-e 's|@LINK_LIBRARIES@|$(addprefix -l,$(NATIVE_LIBRARIES))|g' -e 's|@CMAKE_LIBRARIES@|$(NATIVE_LIBRARIES)|g'

install: $(BUILT)
	$(INSTALL) -d $(addprefix $(DESTDIR),$(INCLUDEDIR) $(LIBDIR) $(PKGCONFIGDIR) $(CMAKEDIR) $(DATADIR)/cophase)
	$(INSTALL) -m 644 $(HEADERS) $(DESTDIR)$(INCLUDEDIR)
	$(INSTALL) -m 644 $(REFERENCE) $(DESTDIR)$(DATADIR)/cophase
	$(INSTALL) -m 755 $(BUILD)/$(SHARED) $(DESTDIR)$(LIBDIR)
	$(INSTALL) -m 644 $(BUILD)/libcophase.a $(DESTDIR)$(LIBDIR)
	ln -sf $(SHARED) $(DESTDIR)$(LIBDIR)/$(SONAME)
	ln -sf $(SONAME) $(DESTDIR)$(LIBDIR)/libcophase.so
	for file in $(PC_FILES); do $(FILL) bindings/c/$$file.in >$(DESTDIR)$(PKGCONFIGDIR)/$$file || exit 1; done
	for file in $(CMAKE_FILES); do $(FILL) bindings/c/$$file.in >$(DESTDIR)$(CMAKEDIR)/$$file || exit 1; done

# Folders are left where others may have their files.
uninstall:
	rm -f $(addprefix $(DESTDIR)$(LIBDIR)/,$(SHARED) $(SONAME) libcophase.so libcophase.a)
	rm -f $(addprefix $(DESTDIR)$(INCLUDEDIR)/,$(notdir $(HEADERS))) $(addprefix $(DESTDIR)$(PKGCONFIGDIR)/,$(PC_FILES))
	rm -rf $(DESTDIR)$(CMAKEDIR)
	rm -f $(DESTDIR)$(DATADIR)/cophase/$(notdir $(REFERENCE))
	-rmdir $(DESTDIR)$(DATADIR)/cophase 2>/dev/null

check-lto: $(BUILT)
	scripts/check-lto $(BUILD)/$(SHARED)
