// Says what is wrong with wrong uses, one line for each.
using System;
using Hapticnet;

internal static class Wrong
{
    private static void Say(Action use)
    {
        try
        {
            use();
            Console.WriteLine("fine");
        }
        catch (HapticException error)
        {
            Console.WriteLine(error.Message);
        }
    }

    private static void Main()
    {
        Say(() => new Master(new Request { RateHz = 5.0 }));
        Say(() => new Master(new Request { Codec = "deadbnad" }));
        Say(() => new Master(new Request { Name = new string('x', 65) }));
        Say(() => new Master(new Request { Axes = 4 }));
        Say(() => new Master(new Request { Parameters = { { "stepn", 0.1 } } }));
        Say(() => new Master(new Request { Parameters = { { "step_n", 0.1 } } }).Dispose());
        Say(() => new Slave("spring", 0));
        Say(() => PrivateKey.Parse("abc"));
        Say(() => new PrivateKey(new byte[31]));
        Say(() => PrivateKey.Load("/nonexistent/key.toml"));
        Say(() => ListedMaster.Load("/nonexistent/masters.toml"));
        Say(() => new Master(new Request()).Seal(new PrivateKey(new byte[32]), new byte[32]));
        Say(() => new Master(new Request { Axes = 2 }).Tick(new double[1], 0));
        Say(() => new Master(new Request()).Send(new byte[100]));
        Say(() => new Master(new Request()).Receive(new byte[3], 4, 0));
        Say(() => new Slave("spring").Receive(new byte[3], 3, new byte[40], 40, 0, new byte[Node.DatagramBytes]));
        Say(() => new MasterLink("nowhere.invalid", 47800, new Request(), null));
        Say(() => new MasterLink("127.0.0.1", 0, new Request(), null));
        Say(() =>
        {
            var master = new Master(new Request(), () => { throw new InvalidOperationException("no entropy"); });
            master.Tick(0);
        });
    }
}
